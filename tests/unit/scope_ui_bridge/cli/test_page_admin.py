"""The command page_admin: passwords, a certificate that serves the page, and the check of the audit file."""

from __future__ import annotations

import io
import json
import os
import shlex
import shutil
import ssl
import stat
import subprocess
import unicodedata
from datetime import datetime
from pathlib import Path

import aiohttp
import pytest
from unit.scope_ui_bridge.web_rig import WITHIN_S, Rig, with_rig

from scope_ui_bridge.adapters.secret_files import AuditFile, read_users
from scope_ui_bridge.cli import page_admin
from scope_ui_bridge.core.access import Role, matches
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.records import AuditError, Gap

pytestmark = pytest.mark.slow


def test_a_password_is_set_changed_and_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "state" / "passwords"
    for name, role, password in (("ada", "engineer", "first password"), ("eve", "viewer", "of another one")):
        monkeypatch.setattr("sys.stdin", io.StringIO(password + "\n"))
        assert page_admin.main(["password", name, "--role", role, "--file", str(file)]) == 0
    monkeypatch.setattr("sys.stdin", io.StringIO("second password\n"))
    assert page_admin.main(["password", "ada", "--file", str(file)]) == 0
    users = read_users(file)
    assert {name: user.role for name, user in users.items()} == {"ada": Role.OPERATOR, "eve": Role.VIEWER}
    assert matches("second password", users["ada"].hashed)
    assert "password" not in file.read_text()
    assert page_admin.main(["password", "eve", "--remove", "--file", str(file)]) == 0
    assert list(read_users(file)) == ["ada"]
    monkeypatch.setattr("sys.stdin", io.StringIO("short\n"))
    assert page_admin.main(["password", "ada", "--file", str(file)]) == 1
    assert "10 to 256" in capsys.readouterr().err


def test_what_people_wrote_into_the_file_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "passwords"
    for arguments in (["ada"], ["eve"]):
        monkeypatch.setattr("sys.stdin", io.StringIO("first password\n"))
        assert page_admin.main(["password", *arguments, "--file", str(file)]) == 0
    ada, eve = file.read_text().splitlines()
    file.write_text(f"# ward 3\n{ada}\n\n# ada: the night's engineer\n{eve}\n")
    monkeypatch.setattr("sys.stdin", io.StringIO("second password\n"))
    assert page_admin.main(["password", "ada", "--file", str(file)]) == 0
    assert [line for line in file.read_text().splitlines() if not line.startswith("ada:")] == [
        *("# ward 3", "", "# ada: the night's engineer", eve)
    ]
    assert matches("second password", read_users(file)["ada"].hashed)
    assert page_admin.main(["password", "eve", "--remove", "--file", str(file)]) == 0
    assert list(read_users(file)) == ["ada"] and "# ward 3" in file.read_text()


def test_a_name_is_set_changed_and_removed_however_its_letters_are_composed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "passwords"
    composed, decomposed = (unicodedata.normalize(form, "Jürgen Groß") for form in ("NFC", "NFD"))
    for number, name in enumerate((composed, decomposed)):
        monkeypatch.setattr("sys.stdin", io.StringIO(f"password {number}\n"))
        assert page_admin.main(["password", name, "--file", str(file)]) == 0
        (user,) = read_users(file).values()
        assert user.name == composed and matches(f"password {number}", user.hashed)
    assert page_admin.main(["password", decomposed, "--remove", "--file", str(file)]) == 0
    assert read_users(file) == {}
    capsys.readouterr()
    for name, why in (("Eva\u202e", r"'Eva\u202e': has U+202E RIGHT-TO-LEFT OVERRIDE"), ("Eva\udcff", "has U+DCFF")):
        monkeypatch.setattr("sys.stdin", io.StringIO("password 3\n"))
        assert page_admin.main(["password", name, "--file", str(file)]) == 1
        assert page_admin.main(["password", name, "--remove", "--file", str(file)]) == 1
        said = capsys.readouterr().err
        assert why in said and said.replace("\n", "").isprintable()
    assert read_users(file) == {}


def test_its_files_are_those_that_bring_up_keeps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr("sys.stdin", io.StringIO("first password\n"))
    assert page_admin.main(["password", "ada"]) == 0
    assert list(read_users(tmp_path / "icu_gantry" / "passwords")) == ["ada"]
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert page_admin.parser().parse_args(["audit"]).file == tmp_path / "home/.local/state/icu_gantry/audit.jsonl"


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_a_certificate_for_a_long_name_is_made_and_one_that_failed_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "tls"
    (tmp_path / "bin").mkdir()
    half = tmp_path / "bin" / "openssl"  # writes the key, and fails then, as on a full disk
    half.write_text("#!/bin/sh\nwhile [ $1 != -keyout ]; do shift; done\n: > $2\necho no space left >&2\nexit 1\n")
    half.chmod(0o755)
    path = os.environ["PATH"]
    monkeypatch.setenv("PATH", f"{half.parent}:{path}")
    assert page_admin.main(["certificate", "icu-7", "--folder", str(folder)]) == 1
    assert "no space left" in capsys.readouterr().err
    assert list(folder.iterdir()) == [], "else the next one is refused"
    monkeypatch.setenv("PATH", path)
    host = f"{'icu-7-' * 5}gantry.{'ward-' * 5}3.hospital.example"  # a name in X.520 has at most 64 characters
    assert len(host) > 64
    assert page_admin.main(["certificate", host, "--folder", str(folder)]) == 0
    show = ["openssl", "x509", "-in", str(folder / "certificate.pem"), "-noout", "-ext", "subjectAltName"]
    assert f"DNS:{host}" in subprocess.run(show, capture_output=True, text=True, check=True).stdout


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_the_page_is_known_by_all_names_of_the_certificate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hosts = ("icu-7", "icu-7.example.org", "192.0.2.7", "2001:db8::7")
    assert page_admin.main(["certificate", *hosts, "--folder", str(tmp_path)]) == 0
    told = shlex.split(capsys.readouterr().out.partition("Use them: ")[2])
    values = dict(text.removeprefix("ui_bridge.").split("=", 1) for text in told if text != "--set")
    config = BridgeConfig(**values)
    names = ("icu-7", "icu-7.example.org", "192.0.2.7", "[2001:db8::7]")
    assert config.origins(config.port) == {f"https://{name}:8080" for name in names}


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_the_certificate_serves_the_page_and_strict_cookies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "tls"
    assert page_admin.main(["certificate", "localhost", "127.0.0.1", "--folder", str(folder)]) == 0
    assert "sha256 Fingerprint=" in capsys.readouterr().out
    key, certificate = folder / "key.pem", folder / "certificate.pem"
    assert stat.S_IMODE(key.stat().st_mode) == 0o600
    assert page_admin.main(["certificate", "localhost", "--folder", str(folder)]) == 1, "no key is overwritten"
    assert page_admin.main(["certificate", "a,DNS:b", "--folder", str(tmp_path / "other")]) == 1

    async def scenario(rig: Rig) -> None:
        trusted = ssl.create_default_context(cafile=str(certificate))
        url = f"https://127.0.0.1:{rig.server.port}/"
        async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session:
            async with session.get(url, params={"token": rig.token}, ssl=trusted) as answer:
                assert answer.status == 200
                assert "Secure" in answer.headers["Set-Cookie"]
            origin = {"Origin": url.rstrip("/")}
            async with session.ws_connect(url + "control", headers=origin, ssl=trusted) as control:
                assert (await control.receive_json(timeout=WITHIN_S))["type"] == "hello"
            with pytest.raises(aiohttp.WSServerHandshakeError):
                await session.ws_connect(
                    url + "control", headers={"Origin": origin["Origin"].replace("https", "http")}, ssl=trusted
                )

    with_rig(scenario, tls_certificate=str(certificate), tls_key=str(key))


def test_the_chain_goes_on_after_a_record_that_lost_only_its_end_of_line(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    audit = AuditFile(path)
    audit.append({"command": "stop"})
    audit.close()
    path.write_bytes(path.read_bytes().removesuffix(b"\n"))  # as after a power cut
    audit = AuditFile(path)
    audit.append({"command": "reset"})
    audit.close()
    AuditFile(path).close()
    assert [json.loads(line)["command"] for line in path.read_text().splitlines()] == ["stop", "reset"]


def test_the_check_of_the_audit_file_names_its_gaps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "audit.jsonl"
    audit = AuditFile(path)
    audit.append(Gap(count=7, from_s=1_800_000_000.0, until_s=1_800_000_060.0).record())
    audit.close()
    assert page_admin.main(["audit", str(path)]) == 0
    begin, end = (f"{datetime.fromtimestamp(at).astimezone():%Y-%m-%d %H:%M:%S %z}" for at in (18e8, 18e8 + 60))
    assert f"\nrecords lost between {begin} and {end}: 7\n" in capsys.readouterr().out


def test_the_audit_file_is_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "audit.jsonl"
    audit = AuditFile(path)
    for number in range(3):
        audit.append({"command": f"press:{number}"})
    assert page_admin.main(["audit", str(path)]) == 0
    said = capsys.readouterr().out
    assert "3 records, intact" in said
    noted = said.split()[-1]
    audit.append({"command": "stop"})
    audit.close()
    assert page_admin.main(["audit", str(path), "--hash", noted]) == 0
    text = path.read_text().splitlines()
    path.write_text("\n".join(text[:2]) + "\n")
    assert page_admin.main(["audit", str(path)]) == 0, "a chain that was cut short is a chain"
    assert page_admin.main(["audit", str(path), "--hash", noted]) == 1, "but the noted hash is missing"
    path.write_text("\n".join([text[0], text[1].replace("press:1", "press:7"), *text[2:]]) + "\n")
    assert page_admin.main(["audit", str(path)]) == 1
    assert "line 3 does not follow" in capsys.readouterr().err
    path.write_bytes(text[0].encode() + b"\n" + text[1].encode().replace(b"press", b"pr\xffss") + b"\n")
    assert page_admin.main(["audit", str(path)]) == 1
    assert "line 2 is damaged" in capsys.readouterr().err
    with pytest.raises(AuditError, match="line 2 is damaged"):
        AuditFile(path)
    assert page_admin.main(["audit", str(tmp_path / "missing")]) == 1


def test_audit_files_that_were_put_aside_are_checked_with_the_newest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "audit.jsonl"
    audit = AuditFile(path, 150)  # two lines each
    for number in range(12):
        audit.append({"command": f"press:{number}"})
    audit.close()
    older = [tmp_path / f"audit.jsonl.{number}" for number in range(1, 6)]
    assert [file.exists() for file in older] == [True] * 5
    check = lambda *more: page_admin.main(["audit", str(path), *more])  # noqa: E731
    assert check() == 0
    assert f"{path} and 5 older: 12 records, intact" in capsys.readouterr().out
    text = older[2].read_text()
    older[2].write_text(text.replace("press:5", "press:9"))
    assert check() == 1
    assert f"{older[3]}: line 1 does not follow" in capsys.readouterr().err
    older[2].unlink()
    assert check() == 1, "one that is missing between others"
    assert f"{older[3]}: line 1 does not follow" in capsys.readouterr().err
    older[2].write_text(text)
    archive = tmp_path / "archive"
    archive.mkdir()
    for file in older[:2]:
        file.rename(archive / file.name)
    (archive / older[1].name).rename(archive / "audit.jsonl")  # its newest bears the chain's name there
    assert page_admin.main(["audit", str(archive / "audit.jsonl")]) == 0
    noted = capsys.readouterr().out.split()[-1]
    assert check() == 1
    assert f"{older[2]}: records 1 to 4 are not here" in capsys.readouterr().err
    assert check("--hash", "0" * 64) == 1
    assert check("--hash", noted) == 0
    assert f"{path} and 3 older: records 5 to 12, intact" in capsys.readouterr().out
