"""Starts Python programs as forks of one process that has already imported their common modules.

Importing numpy, rclpy and numba takes most of a program's start time, and fourteen programs do it at the same time. The
server imports each module once, and each program starts with these modules. See docs/decisions/start-up.md.

The server forks twice: the program's direct parent exits at once, and the kernel gives the program to bring-up, which
is the nearest child subreaper (prctl(2)). So bring-up waits for it, signals it and restarts it as any other child.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import importlib.metadata
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

_PR_SET_PDEATHSIG, _PR_SET_NAME, _PR_SET_CHILD_SUBREAPER = 1, 15, 36
_TITLE_BYTES = 8192
"""Bytes reserved for a program's command line, which ``ps`` and ``pkill -f`` read."""
_MESSAGE_BYTES = 65536
_ARG_START, _ARG_END = 45, 46
"""Fields of /proc/self/stat after the name (proc(5)): memory addresses of the command line."""
_LEAVE_S = 1.0
"""Maximum seconds for the server to finish a fork."""


def die_with_parent() -> None:
    """Let the kernel send SIGTERM when the parent ends (prctl(2)): a killed bring-up leaves no process."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def is_forkable(command: Sequence[str]) -> bool:
    """Return whether a command is a Python script of this very interpreter."""
    with contextlib.suppress(OSError), Path(command[0]).open("rb") as script:
        return script.readline(4096).rstrip() == b"#!" + os.fsencode(sys.executable)
    return False


class ForkedProcess:
    """A program that the server starts; its methods are those of ``subprocess.Popen`` that bring-up uses."""

    def __init__(self, server: ForkServer, stdout: IO[bytes]) -> None:
        self._server = server
        self.stdout: IO[bytes] | None = stdout
        self.pid = 0
        """0 until the server has forked."""
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Return the exit code, negative for a signal, once the program has ended."""
        if self.returncode is None and not self.pid and not self._server.receive():
            self.returncode = 1
        if self.returncode is None and self.pid:
            ended, status = os.waitpid(self.pid, os.WNOHANG)
            if ended:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send a signal, unless the program has ended or has not been forked."""
        if self.poll() is None and self.pid:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)


class ForkServer:
    """Bring-up's end of the server.

    Parameters
    ----------
    environment
        Environment of the server and of each program.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        command = [sys.executable, "-m", "icu_bringup.cli.fork_server", str(theirs.fileno()), str(os.getpid())]
        with theirs:
            self._process = subprocess.Popen(
                [*command, "-" * _TITLE_BYTES],
                env=dict(environment),
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=die_with_parent,
            )
        assert self._process.stdout is not None
        self.stdout: IO[bytes] = self._process.stdout
        self._socket.setblocking(False)
        self._unsent: deque[tuple[bytes, list[int]]] = deque()
        self._expected: dict[int, ForkedProcess] = {}
        self._requests = 0
        self._open = True

    @property
    def pid(self) -> int:
        """Process number of the server."""
        return self._process.pid

    @property
    def runs(self) -> bool:
        """Whether the server accepts requests."""
        return self._open and self._process.poll() is None

    def start(
        self, command: Sequence[str], environment: Mapping[str, str], ready_fd: int | None, ready_name: str
    ) -> ForkedProcess:
        """Ask for a program; it is forked when the server has imported its module.

        Parameters
        ----------
        command
            Path of a Python script, and its arguments.
        environment
            Variables in addition to the server's.
        ready_fd, ready_name
            File descriptor that the program inherits, and the variable that names it.
        """
        out_read, out_write = os.pipe()
        self._requests += 1
        request = {"id": self._requests, "command": list(command), "environment": dict(environment)}
        request["ready"] = ready_name if ready_fd is not None else ""
        fds = [out_write, *([] if ready_fd is None else [os.dup(ready_fd)])]
        self._unsent.append((json.dumps(request).encode(), fds))
        process = ForkedProcess(self, os.fdopen(out_read, "rb", 0))
        self._expected[self._requests] = process
        self._send()
        return process

    def _send(self) -> None:
        """Send as much as the socket takes: a system may allow ten unread requests, and the server is importing."""
        while self._open and self._unsent:
            data, fds = self._unsent[0]
            try:
                socket.send_fds(self._socket, [data], fds)
            except BlockingIOError:
                return
            except OSError:
                self._open = False
            self._unsent.popleft()
            for fd in fds:
                os.close(fd)

    def receive(self) -> bool:
        """Process the received answers; return False if the server has ended and no answer can follow."""
        self._send()
        while self._open:
            try:
                data = self._socket.recv(_MESSAGE_BYTES)
            except BlockingIOError:
                return True
            except OSError:
                data = b""
            if not data:
                self._open = False
                break
            number, pid = json.loads(data)
            self._expected.pop(number).pid = pid
        return False

    def stop(self) -> None:
        """End the server; programs that it has not forked do not start, and those that it has forked are known."""
        self._process.terminate()
        try:
            self._process.wait(_LEAVE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self.receive()
        self._open = False
        self._socket.close()
        for _, fds in self._unsent:
            for fd in fds:
                os.close(fd)
        self._unsent.clear()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Request:
    number: int
    command: list[str]
    environment: dict[str, str]
    ready: str
    fds: list[int]


def serve(link: socket.socket, bring_up: int) -> list[str] | None:
    """Fork a program for each request.

    Parameters
    ----------
    link
        Socket of the requests.
    bring_up
        Process number of bring-up, which becomes each program's parent.

    Returns
    -------
    list of str, or None
        In the fork: the command to run. In the server: None, after bring-up has ended.
    """
    while (request := _next(link)) is not None:
        _preload(request.command)
        gc.collect()
        gc.freeze()  # a collection in a program would write to, and so copy, every page with objects
        # SIGTERM must not end the server between the fork and its answer: bring-up would have no record of the program.
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
        answered, answering = os.pipe()
        middle = os.fork()
        if middle == 0:
            os.close(answered)
            return _become(request, link, bring_up, answering)
        os.close(answering)
        os.read(answered, 1)  # ends when the program has closed its end
        os.close(answered)
        os.waitpid(middle, 0)
        for fd in request.fds:
            os.close(fd)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])
    return None


def _next(link: socket.socket) -> _Request | None:
    data, fds, _, _ = socket.recv_fds(link, _MESSAGE_BYTES, 2)
    if not data:
        return None
    given: dict[str, Any] = json.loads(data)
    return _Request(
        number=given["id"],
        command=given["command"],
        environment=given["environment"],
        ready=given["ready"],
        fds=list(fds),
    )


def _preload(command: Sequence[str]) -> None:
    """Import the module of a script PREFIX/lib/PACKAGE/EXECUTABLE, which loads its compiled code.

    The program reports a failed import itself, as it fails there as well.
    """
    script = Path(command[0])
    with contextlib.suppress(Exception):
        for entry in importlib.metadata.distribution(script.parent.name).entry_points:
            if entry.group == "console_scripts" and entry.name == script.name:
                module = importlib.import_module(entry.module)
                getattr(module, "preload", lambda: None)()


def _become(request: _Request, link: socket.socket, bring_up: int, answering: int) -> list[str]:
    """Turn a fork of the server into a program that is a child of bring-up."""
    middle = os.getpid()
    if os.fork():
        os._exit(0)
    # The kernel reassigns a process's children before its descriptor becomes readable.
    ended = os.pidfd_open(middle)
    select.select([ended], [], [])
    os.close(ended)
    die_with_parent()
    if os.getppid() != bring_up:  # bring-up has ended meanwhile
        os._exit(1)
    link.send(json.dumps([request.number, os.getpid()]).encode())
    link.close()
    os.close(answering)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])
    os.setsid()
    os.dup2(request.fds[0], 1)
    os.dup2(request.fds[0], 2)
    os.close(request.fds[0])
    os.environ.update(request.environment)
    if request.ready:
        os.set_inheritable(request.fds[1], True)
        os.environ[request.ready] = str(request.fds[1])
    with contextlib.suppress(OSError, ValueError):
        _set_title(request.command)
    return request.command


def _set_title(command: Sequence[str]) -> None:
    """Write the command line over the server's, for ``ps`` and ``pkill -f``."""
    fields = Path("/proc/self/stat").read_text(errors="replace").rpartition(")")[2].split()
    start, end = int(fields[_ARG_START]), int(fields[_ARG_END])
    if end - start < _TITLE_BYTES:
        return
    words = b"".join(os.fsencode(word) + b"\0" for word in (sys.executable, *command))[: end - start - 1]
    ctypes.memset(start, 0, end - start)
    ctypes.memmove(start, words, len(words))
    ctypes.CDLL(None).prctl(_PR_SET_NAME, os.fsencode(Path(command[0]).name), 0, 0, 0)


def run_script(command: list[str]) -> None:
    """Run a Python script in this process as if the interpreter had been started with it.

    A script that fails ends at once. Its half-made node still has threads of the middleware, which can crash while the
    interpreter shuts down; bring-up would then get a signal instead of the exit code, and restart the program.
    """
    sys.argv = list(command)
    try:
        runpy.run_path(command[0], run_name="__main__")
    except SystemExit as end:
        if isinstance(end.code, int) and end.code:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(end.code)
        raise
