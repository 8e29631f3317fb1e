"""By default nothing of the graph can be reached from another machine."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from importlib import resources
from pathlib import Path
from xml.etree import ElementTree

import pytest
from std_msgs.msg import String
from std_srvs.srv import Trigger
from support.ros_rig import Ros, domain_of_worker

from icu_common.adapters import transport_profile
from icu_common.adapters.transport_profile import check_environment
from icu_common.nodes import qos, runtime
from icu_common.nodes.runtime import prepare_transport


@pytest.fixture
def domain() -> int:
    """A domain whose ports lie below those that the system chooses, else one of these may be among them by chance."""
    return domain_of_worker(1, 9)


def udp_sockets(process: int) -> list[tuple[str, int]]:
    """Return address and port of a process's UDP sockets."""
    inodes = set()
    for link in Path(f"/proc/{process}/fd").iterdir():
        try:
            inodes.add(str(link.readlink()).removeprefix("socket:[").removesuffix("]"))
        except OSError:
            continue
    found = []
    for line in Path("/proc/net/udp").read_text().splitlines()[1:]:
        fields = line.split()
        if fields[9] in inodes:
            address, port = fields[1].split(":")
            found.append((socket.inet_ntoa(bytes.fromhex(address)[::-1]), int(port, 16)))
    return found


def test_dds_hears_on_loopback_alone(ros: Ros) -> None:
    node = ros.plain("talker")
    publisher = node.create_publisher(String, "words", qos.RESULTS)
    heard = ros.collect(node, String, "words", qos.RESULTS)
    ros.spin_until(publisher.get_subscription_count, 10.0)
    publisher.publish(String(data="x"))
    ros.spin_until(lambda: heard, 10.0)
    first = 7400 + 250 * ros.context.get_domain_id()  # the ports of a domain (RTPS 9.6.2.3)
    with Path("/proc/sys/net/ipv4/ip_local_port_range").open() as stream:
        least = int(stream.read().split()[0])
    assert first + 250 <= least
    ports = [(address, port) for address, port in udp_sockets(os.getpid()) if first <= port < first + 250]
    assert ports and {address for address, _ in ports} == {"127.0.0.1"}, ports
    # The other open sockets are for sending: no program reads there, and the system chooses their ports.
    others = [(a, p) for a, p in udp_sockets(os.getpid()) if a != "127.0.0.1" and p < least]
    assert others == []


@pytest.fixture
def small_buffers(monkeypatch: pytest.MonkeyPatch) -> None:
    """A system that grants sockets 208 kB, as Ubuntu does by default; asked for before ``ros``."""
    monkeypatch.setattr(runtime, "sockets_hold_pictures", lambda: False)
    for variable in ("FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE"):
        monkeypatch.delenv(variable, raising=False)


def test_the_driver_shares_no_memory_and_hears_on_loopback_alone(small_buffers: None, ros: Ros, tmp_path: Path) -> None:
    """A process that is stopped or killed while it holds a lock in shared memory holds up all who share it, for 1 s."""
    command = [sys.executable, "-m", "gantry_driver.nodes.serial_driver_node", "--ros-args", "-p", "port:=/dev/null"]
    environment = {**os.environ, "ROS_DOMAIN_ID": str(ros.context.get_domain_id())}
    said = tmp_path / "said.txt"
    with said.open("wb") as out:
        driver = subprocess.Popen(command, env=environment, stdout=out, stderr=subprocess.STDOUT)
    try:
        node = ros.plain("asker")
        stop = node.create_client(Trigger, "stop")
        ros.spin_until(stop.service_is_ready, 40.0)  # found, though this side has shared memory and another range
        ros.ask(stop, Trigger.Request())
        assert "/dev/shm/fastrtps_" in Path("/proc/self/maps").read_text()
        mapped = [line for line in Path(f"/proc/{driver.pid}/maps").read_text().splitlines() if "/dev/shm/" in line]
        given = {name: value for name, value in environment.items() if "FAST" in name or "ROS" in name}
        assert not any("fastrtps_" in line for line in mapped), (mapped, given, said.read_text())
        assert {address for address, _ in udp_sockets(driver.pid)} == {"127.0.0.1"}
    finally:
        driver.kill()
        driver.wait(20.0)


@pytest.mark.parametrize(
    ("name", "value", "kind"),
    [
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST", "local_"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET", ""),
        ("ROS_STATIC_PEERS", "192.0.2.7", ""),
        ("ROS_DISCOVERY_SERVER", "192.0.2.7:11811", ""),
    ],
)
@pytest.mark.parametrize("large", [False, True])
def test_only_a_wish_opens_the_network(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str, kind: str, large: bool
) -> None:
    for variable in ("FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(runtime, "sockets_hold_pictures", lambda: large)
    monkeypatch.setenv(name, value)
    for _ in ("bring-up", "a program that it starts", "a program of that one"):
        prepare_transport()
        chosen = Path(os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"]).name
        assert chosen == f"fastdds_{kind}{'sockets_' if large else ''}profile.xml"


@pytest.mark.parametrize(("granted", "enough"), [(212_992, False), (4 << 20, True)])
def test_shared_memory_is_used_where_the_buffers_are_small(
    monkeypatch: pytest.MonkeyPatch, granted: int, enough: bool
) -> None:
    class Limited(socket.socket):
        """Linux limits a requested size to net.core.rmem_max and wmem_max, and reports twice the granted size."""

        def setsockopt(self, level: int, option: int, value: int) -> None:  # type: ignore[override]
            self.limit = min(value, granted)

        def getsockopt(self, level: int, option: int) -> int:  # type: ignore[override]
            return 2 * self.limit

    monkeypatch.setattr(socket, "socket", Limited)
    assert transport_profile.sockets_hold_pictures() is enough


@pytest.mark.parametrize(
    ("setting", "whole"),
    [
        ({}, True),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, True),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, False),
        ({"ROS_STATIC_PEERS": "192.0.2.7"}, False),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "/own.xml"}, False),
    ],
)
def test_pictures_are_asked_for_again_where_they_may_not_arrive_whole(setting: dict[str, str], whole: bool) -> None:
    """Over a network, or with buffers that may hold no picture; else a reader that asks may hang after a kill."""
    inherited = ("FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS")
    environment = {name: value for name, value in os.environ.items() if name not in inherited} | setting
    code = "from icu_common.nodes import qos; print(qos.PICTURES.reliability.name, qos.NEWEST.reliability.name)"
    said = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True, timeout=60.0
    ).stdout.split()
    best_effort = whole and transport_profile.sockets_hold_pictures()
    assert said == ["BEST_EFFORT" if best_effort else "RELIABLE"] * 2


@pytest.mark.parametrize(("wanted", "kept"), [("LOCALHOST", "SYSTEM_DEFAULT"), ("SUBNET", "SUBNET")])
def test_a_program_that_must_not_wait_has_no_shared_memory(
    monkeypatch: pytest.MonkeyPatch, wanted: str, kept: str
) -> None:
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", wanted)
    prepare_transport()  # as its parent does
    prepare_transport(shared_memory=False)
    profile = ElementTree.parse(os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"])
    name = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"
    assert [element.text for element in profile.findall(f".//{name}type")] == ["UDPv4"]
    assert [element.text for element in profile.findall(f".//{name}userTransports/{name}transport_id")] == ["udp"]
    assert (profile.find(f".//{name}interfaceWhiteList") is not None) == (wanted == "LOCALHOST")
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == kept  # with LOCALHOST rmw would add shared memory


def test_the_users_own_profile_stays(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(tmp_path / "own.xml"))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    prepare_transport(shared_memory=False)
    assert os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] == str(tmp_path / "own.xml")
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


def test_the_profiles_differ_in_the_interface_alone() -> None:
    def lines(name: str) -> set[str]:
        return set((resources.files("icu_common") / name).read_text().splitlines()[2:])

    assert lines("fastdds_profile.xml") < lines("fastdds_local_profile.xml")
    more = lines("fastdds_local_profile.xml") - lines("fastdds_profile.xml")
    assert [line.strip() for line in more] == ["<interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>"]


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("ROS_DOMAIN_ID", "lab", "ROS_DOMAIN_ID = 'lab'; expected a whole number from 0 to 232"),
        ("ROS_DOMAIN_ID", "233", "ROS_DOMAIN_ID = '233'; expected a whole number from 0 to 232"),
        ("ROS_STATIC_PEERS", "127.0.0.1;no.host.invalid", "ROS_STATIC_PEERS: no address of 'no.host.invalid' is found"),
    ],
)
def test_wrong_environment_ends_a_program_with_one_line(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], name: str, value: str, words: str
) -> None:
    """The middleware ends the process without the value, or by a traceback."""
    monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit) as ended:
        prepare_transport()
    said = capfd.readouterr()
    assert ended.value.code == 2 and said.out == ""
    assert said.err.startswith(f"error: {words}") and said.err.count("\n") == 1


@pytest.mark.parametrize("domain", ["", "0", "232", "0x10"])
def test_every_ros_domain_that_the_middleware_takes_is_taken(monkeypatch: pytest.MonkeyPatch, domain: str) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    monkeypatch.setenv("ROS_STATIC_PEERS", "127.0.0.1;localhost;")
    check_environment()
