"""Manage the operator page from the terminal: passwords, certificate, check of the audit file.

Exit codes: 0 done, 1 failed or audit file not intact (with the reason), 2 wrong usage.
"""

from __future__ import annotations

import argparse
import getpass
import ipaddress
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.adapters.state_folder import default_state_folder
from icu_common.core.configuration.option_bounds import named_path
from scope_ui_bridge.adapters.secret_files import older_files, read_users, write_secret
from scope_ui_bridge.core.access import PasswordError, Role, composed, new_user
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.records import BAD_BYTES, AuditError, gaps, line_before, verify

_DAYS = 825  # maximum that browsers accept
_MAX_COMMON_NAME = 64  # limit of X.520; browsers read the alternative names instead


class AdminError(Exception):
    """The command failed; the message is the reason."""


def parser() -> argparse.ArgumentParser:
    state = default_state_folder()  # for a robot without a namespace
    result = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = result.add_subparsers(dest="command", required=True)
    password = commands.add_parser("password", help="let somebody sign in by name, or change role or password")
    password.add_argument("name")
    password.add_argument("--role", choices=[role.value for role in Role], default=Role.OPERATOR.value)
    password.add_argument("--remove", action="store_true", help="let this name in no longer")
    password.add_argument("--file", type=named_path, default=state / "passwords", help="default: %(default)s")
    certificate = commands.add_parser("certificate", help="make a certificate for TLS, signed by itself")
    certificate.add_argument("host", nargs="+", help="names or addresses by which browsers reach this machine")
    certificate.add_argument("--folder", type=named_path, default=state / "tls", help="default: %(default)s")
    audit = commands.add_parser("audit", help="check that no record was changed, removed or inserted")
    audit.add_argument("file", type=named_path, nargs="?", default=state / "audit.jsonl", help="default: %(default)s")
    audit.add_argument("--hash", help="hash of the last line that was noted before, which must be among the records")
    return result


def change_password(name: str, role: str, path: Path, password: str | None) -> str:
    """Write a user to the file, or remove it (``password`` None); return a sentence about the change."""
    name = composed(name)
    users = read_users(path) if path.exists() else {}
    before = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    lines = [line for line in before if composed(line.strip().partition(":")[0]) != name]  # people's comments are kept
    if password is None:
        if name not in users:
            raise AdminError(f"{name!r} is not in {path}")
    else:
        lines.append(new_user(name, role, password, os.urandom(16)).line())
    write_secret(path, "\n".join(lines))
    return f"{name} is no longer in {path}" if password is None else f"{name} ({role}) can sign in; {path}"


def ask_password() -> str:
    """Prompt twice on a terminal; otherwise read one line."""
    if not sys.stdin.isatty():
        return sys.stdin.readline().rstrip("\n")
    first = getpass.getpass("Password: ")
    if getpass.getpass("Once more: ") != first:
        raise AdminError("the two are not the same")
    return first


def make_certificate(hosts: Sequence[str], folder: Path) -> str:
    """Make key and certificate with openssl; return their paths, fingerprint and use."""
    program = shutil.which("openssl")
    if program is None:
        raise AdminError("openssl is not installed (Debian and Ubuntu: apt install openssl)")
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    key, certificate = folder / "key.pem", folder / "certificate.pem"
    for path in (key, certificate):
        if path.exists():
            raise AdminError(f"{path} exists; move it away first")
    names = ",".join(f"{_kind(host)}:{host}" for host in hosts)
    command = [program, "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-sha256"]
    command += ["-days", str(_DAYS), "-keyout", str(key), "-out", str(certificate)]
    command += ["-subj", f"/CN={hosts[0][:_MAX_COMMON_NAME]}"]
    command += ["-addext", f"subjectAltName={names}", "-addext", "extendedKeyUsage=serverAuth"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        for path in (key, certificate):
            path.unlink(missing_ok=True)
        raise AdminError(f"openssl: {done.stderr.strip()}")
    key.chmod(0o600)
    shown = subprocess.run(
        [program, "x509", "-in", str(certificate), "-noout", "-fingerprint", "-sha256", "-enddate"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()
    use = [f"host={hosts[0]}", f"tls_certificate={certificate}", f"tls_key={key}"]
    if hosts[1:]:  # the bridge accepts only its host's name by default
        further = (f"[{host}]" if ":" in host else host for host in hosts[1:])
        use.append("extra_origins=" + " ".join(f"https://{host}:{BridgeConfig().port}" for host in further))
    settings = " ".join(f"--set {shlex.quote(f'ui_bridge.{text}')}" for text in use)
    return f"{certificate}\n{key}\n{shown}\nUse them: {settings}"


def _kind(host: str) -> str:
    if not host or (any(character in host for character in ",:=/ ") and ":" not in host):
        raise AdminError(f"{host!r} is no name or address")
    try:
        ipaddress.ip_address(host)
    except ValueError:
        if not all(part.replace("-", "").isalnum() for part in host.split(".")):
            raise AdminError(f"{host!r} is no name or address") from None
        return "DNS"
    return "IP"


def check_audit(path: Path, noted: str | None) -> str:
    """Check a chain from its oldest file on; ``noted`` is a hash that one of its lines must have."""
    files = [*older_files(path), path]
    with files[0].open(encoding="utf-8", errors=BAD_BYTES) as lines:
        gone, last = line_before(next(lines, ""))
    if gone and last != noted:
        raise AdminError(
            f"{files[0]}: records 1 to {gone} are not here. If they were put into an archive, check them there, and "
            f"here with the hash of the last one: it must be {last}"
        )
    count, known, lost = gone, noted is None, list[str]()
    for file in files:
        text = file.read_text(encoding="utf-8", errors=BAD_BYTES).splitlines()
        try:
            count, last = verify(text, count, last)
        except AuditError as error:
            raise AuditError(f"{file}: {error}") from error
        # Each line has the hash of the previous one, so the noted hash is in the line after it, or belongs to the last
        # line.
        lost += gaps(text)
        known = known or noted == last or any(f'"previous":"{noted}"' in line for line in text)
    if not known:
        raise AdminError(f"{path} is a whole chain, but the noted hash is not in it: another file, or cut short")
    where = f"{path} and {len(files) - 1} older" if files[1:] else str(path)
    what = f"{count} records" if not gone else f"records {gone + 1} to {count}"
    return "\n".join([f"{where}: {what}, intact; hash of the last: {last}", *lost])


def run(options: argparse.Namespace) -> str:
    """Carry out a command."""
    if options.command == "password":
        password = None if options.remove else ask_password()
        return change_password(options.name, options.role, options.file.expanduser(), password)
    if options.command == "certificate":
        return make_certificate(options.host, options.folder.expanduser())
    return check_audit(options.file.expanduser(), options.hash)


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    options = parser().parse_args(arguments)
    try:
        print(run(options))
    except (AdminError, AuditError, PasswordError, OSError) as error:
        print(f"page_admin: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
