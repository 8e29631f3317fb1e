"""Lines to the board and their answers, by character counting; no I/O and no clock.

When its receive buffer overflows, GRBL loses bytes without a message. It answers lines in order, and only when it has
planned them. It does not report lines that a reset discards. So this module counts every byte, every line ends as
acknowledged, refused or lost, and an unrequested reset is a separate event.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Iterator

from gantry_driver.core.grbl.buffers import BoardBuffers
from gantry_driver.core.grbl.contradictions import OUT_OF_TURN, Contradictions
from gantry_driver.core.grbl.grbl_messages import (
    Alarm,
    Banner,
    BuildOptions,
    ErrorAnswer,
    Feedback,
    Garbage,
    GrblMessage,
    LineReader,
    OkAnswer,
    StatusReport,
    parse_line,
)
from gantry_driver.core.grbl.lines import (
    MAX_LINE_BYTES,
    Acknowledged,
    CountBroken,
    Counts,
    GrblLine,
    LineRefused,
    StrayAnswer,
    WasReset,
)
from gantry_driver.core.grbl.modes import ASK_MODES
from gantry_driver.core.grbl.report_requests import SILENT_POLLS, ReportRequests
from icu_common.core.reasons.message import Message, quoted

HOLD = b"!"
RESUME = b"~"
STATUS = b"?"
SOFT_RESET = b"\x18"
FULL_FEED, FULL_SPINDLE = b"\x90", b"\x99"
"""Real-time bytes that reset the overrides to 100 %."""

DEFAULT_RX_BYTES = 128
EEPROM_PAUSE_S = 0.05
"""Pause in seconds after the ``ok`` of an EEPROM write; without it, bytes were lost in trials."""
WIRE_BOUND_REPORTS = 3
"""Number of successive reports with room in the planner after which the wire, not the motion, counts as the limit."""
WIRE_BOUND_POLL_S = 0.05
"""Minimum interval in seconds between status reports while the wire is the limit: a report occupies the wire for as
long as fifteen answers. The next report shows an unrequested feed override, which must end within 0.1 s."""
SPARE_LINES = 2
"""Number of lines for which the board's buffer keeps room while motion is the limit. Without this room the buffer is
full, and one surplus answer would make a line overflow it. Streaming is not slower."""
RESET_RETRY_S = 1.0
"""Seconds after which a reset without a banner is sent again: the board may have ignored it (GRBL does for about 500 ms
after ALARM:1 and 2). A board that was only delayed answers both, see docs/decisions/stopping.md."""

REPORTS_APART_S = 1.0
"""Seconds by which an interval between reports may exceed the polling interval; in a longer one the board may have been
homing, and does not count as idle."""


class GrblSession:
    """Lines, answers and reports of one connection.

    Pass received bytes to :meth:`receive`, send with :meth:`queue` and :meth:`realtime`, and write the bytes that
    :meth:`output` returns. All times are seconds of one monotonic clock.
    """

    def __init__(self, counts: Counts | None = None) -> None:
        self.counts = counts if counts is not None else Counts()
        self.rx_bytes = DEFAULT_RX_BYTES
        self._planner_blocks = 0
        self.poll_interval_s = 0.1
        self.sets_feed_back = False
        """Whether to repeat an unanswered ``?`` together with a feed reset: damage may have made it an override."""
        self.awaiting_banner = False
        self.latency_s = 0.0
        self._reader = LineReader()
        self._queue: deque[GrblLine] = deque()
        self._in_flight: deque[tuple[GrblLine, float]] = deque()
        self._in_flight_bytes = 0
        self._realtime = bytearray()
        self._number = 0
        self._buffers = BoardBuffers()
        self._rx_empty = -1
        self._contradictions = Contradictions()
        self._quiet_until = 0.0
        self._next_poll = 0.0
        self._reset_at = 0.0
        self._resets_unanswered = 0
        """Number of written resets whose banners may still arrive: all but one are retries."""
        self.wco_is_sure = False
        """Whether the last two reports with a work offset agree."""
        self.wco_mm: tuple[float, ...] | None = None
        """Work offset that the board has reported since its reset: the stored G54 plus later offsets."""
        self._roomy_reports = 0
        self._requests = ReportRequests()
        self.report_asked_at = 0.0
        """Time of the request for the last report: the board wrote the report later than that, however late it came."""
        self.blocks_waiting = -1
        """Maximum number of blocks in the planner according to the last report, -1 if unknown."""
        self.last_report_at: float | None = None
        self.unread_report = b""
        """The last unreadable report, if no readable one has followed."""
        self.unplaced_reports = 0
        """Number of successive reports that give no machine position."""
        self.polling = False
        self.tells_mpos = False
        """Whether the last report contained a machine position."""
        self.polls_spared = True
        """Whether status requests may be rarer while the wire is the limit."""
        self.paused = False

    def start(self, now: float) -> None:
        """Restart on a newly opened port; all lines are dropped, and the sent ones count as lost."""
        self._drop_lines()
        self._reader.clear()
        self._realtime.clear()
        self.awaiting_banner = False
        self._resets_unanswered = 0
        self.paused = False
        self.polling = False
        self.rx_bytes = DEFAULT_RX_BYTES
        self._planner_blocks = 0
        self._buffers, self._rx_empty = BoardBuffers(), -1
        self._contradictions.clear()
        self.last_report_at, self.unread_report, self.unplaced_reports = None, b"", 0
        self._requests.clear()
        self.wco_mm, self.wco_is_sure = None, False
        self._quiet_until = self._next_poll = now

    @property
    def pending(self) -> int:
        """Number of lines that are queued, or sent and not answered."""
        return len(self._queue) + len(self._in_flight)

    @property
    def sent_number(self) -> int:
        """Number of the last line that was sent."""
        return self._number - len(self._queue)

    @property
    def tells_buffers(self) -> bool:
        """Whether reports show how full the board's buffers are."""
        return self._buffers.reported

    @property
    def answers_number(self) -> int:
        """Number of the oldest line without an answer, 0 for none."""
        return self._in_flight[0][0].number if self._in_flight else 0

    @property
    def unsent(self) -> int:
        """Number of lines queued and not sent."""
        return len(self._queue)

    @property
    def in_flight_bytes(self) -> int:
        """Number of bytes sent and not acknowledged."""
        return self._in_flight_bytes

    def queue(self, text: str, *, answer_within_s: float = 3.0) -> GrblLine:
        """Append a line; it is sent when the board has room for it.

        Raises
        ------
        ValueError
            If the line is empty or too long, or has a byte that is not printable ASCII or is a real-time command.
        """
        if not text or len(text) + 1 > MAX_LINE_BYTES:
            raise ValueError(Message("grbl.line_length", text=quoted(text), size=len(text) + 1, limit=MAX_LINE_BYTES))
        for column, char in enumerate(text, 1):
            if not " " <= char <= "}" or char in "!?":
                raise ValueError(
                    Message("grbl.line_column_cannot_part_line", text=quoted(text), column=column, char=quoted(char))
                )
        if not self.pending:
            self._roomy_reports = 0
        self._number += 1
        line = GrblLine.of(self._number, text, answer_within_s)
        self._queue.append(line)
        return line

    def realtime(self, code: bytes) -> None:
        """Send one real-time byte before everything else."""
        self._realtime += code

    def withdraw(self, code: bytes) -> None:
        """Cancel a real-time byte that has not been sent."""
        self._realtime = self._realtime.replace(code, b"")

    def soft_reset(self, now: float) -> None:
        """Send 0x18 and wait for the banner; until then no line is sent and every answer is ignored."""
        self._realtime += SOFT_RESET
        self.awaiting_banner = True
        self._reset_at = now
        self._drop_queue()

    def receive(self, data: bytes, now: float) -> Iterator[GrblMessage]:
        """Take bytes from the board and yield their messages, in order.

        The caller's reaction to a message takes effect before the next one is interpreted; exhaust the iterator.
        """
        self.counts.bytes_received += len(data)
        for raw in self._reader.feed(data):
            yield from self._interpret(parse_line(raw), now)

    def _interpret(self, message: GrblMessage, now: float) -> list[GrblMessage]:
        if isinstance(message, (OkAnswer, ErrorAnswer, StatusReport)) and not self.awaiting_banner:
            # The answered bytes were sent after every reset, so the board has executed or ignored all resets.
            self._resets_unanswered = 0
        if isinstance(message, (OkAnswer, ErrorAnswer)):
            return self._answer(message, now)
        if isinstance(message, StatusReport):
            return self._report(message, now)
        if isinstance(message, Banner):
            return self._banner(message, now)
        if isinstance(message, Garbage):
            self.counts.garbage += 1
            if message.raw.startswith(b"<"):
                self.unread_report = message.raw
        elif isinstance(message, Alarm):
            self.counts.alarms += 1
        elif isinstance(message, Feedback) and message.key == "GC":
            asked = not self._in_flight or self._in_flight[0][0].text == ASK_MODES
            return [message] if asked or self.awaiting_banner else [message, CountBroken(reason=OUT_OF_TURN)]
        elif isinstance(message, BuildOptions):
            self.rx_bytes = message.rx_bytes or DEFAULT_RX_BYTES
            self._planner_blocks = message.planner_blocks
        return [message]

    def _answer(self, answer: GrblMessage, now: float) -> list[GrblMessage]:
        # While a reset is in transit, an aborted line can still cause an ok; no counted line belongs to it.
        if self.awaiting_banner or not self._in_flight:
            self.counts.stray += 1
            return [StrayAnswer(answer=answer)]
        line, sent_at = self._in_flight.popleft()
        self._in_flight_bytes -= line.size
        self._contradictions.answered()
        self.latency_s = now - sent_at
        if line.eeprom:
            self._quiet_until = now + EEPROM_PAUSE_S
        if isinstance(answer, ErrorAnswer):
            self.counts.refused += 1
            return [LineRefused(line=line, code=answer.code)]
        self.counts.acknowledged += 1
        return [Acknowledged(line=line)]

    def _report(self, report: StatusReport, now: float) -> list[GrblMessage]:
        self.counts.reports += 1
        before, self.last_report_at, self.unread_report = self.last_report_at, now, b""
        silent = before is not None and now - before > SILENT_POLLS * self.poll_interval_s
        self.report_asked_at = self._requests.answered(now, silent=silent)
        if before is None or now - before > self.poll_interval_s + REPORTS_APART_S:
            self._contradictions.answered()
        events: list[GrblMessage] = []
        if report.wco_mm is not None:
            self.wco_is_sure = self.wco_mm == report.wco_mm
            self.wco_mm = report.wco_mm
        self.tells_mpos = report.mpos_mm is not None
        if report.mpos_mm is None and report.wpos_mm is not None and self.wco_mm is not None:
            mpos = tuple(w + o for w, o in zip(report.wpos_mm, self.wco_mm))
            report = dataclasses.replace(report, mpos_mm=mpos)
        self.unplaced_reports = self.unplaced_reports + 1 if report.mpos_mm is None else 0
        self._buffers.note(report, in_flight=bool(self._in_flight))
        if report.rx_free >= 0 and not self._in_flight:
            self._rx_empty = report.rx_free
        if report.planner_free <= 1:
            self._roomy_reports = 0
        elif not (self._in_flight and self._in_flight[-1][0].alone):  # a line sent alone is itself the limit
            self._roomy_reports += 1
        # A line that moves makes at least one block, and each block in the planner still waits. If a board does not
        # report its planner ($10=1), the planner may be full.
        self.blocks_waiting = self._planner_blocks or -1
        if report.planner_free >= 0:
            self.blocks_waiting = self._buffers.planner.held(report.planner_free)
        if self.blocks_waiting >= 0:
            self._executed(self.counts.acknowledged - self.blocks_waiting)
        broken = ""
        if not self.awaiting_banner:
            broken = self._contradictions.find(report, self._buffers, self._in_flight, self._in_flight_bytes, now)
        events.append(report)
        if broken:
            events.append(CountBroken(reason=broken))
        return events

    def _banner(self, banner: Banner, now: float) -> list[GrblMessage]:
        # A delayed board answers the reset and its retry, one after the other.
        expected = self.awaiting_banner or self._resets_unanswered > 0
        self._resets_unanswered = max(0, self._resets_unanswered - 1)
        self.counts.resets += 1
        lost, unsent = self._drop_lines()
        # A reset that has not been sent is no longer needed.
        self.withdraw(SOFT_RESET)
        self.awaiting_banner = False
        self.paused = False
        self.wco_mm, self.wco_is_sure = None, False
        self._buffers, self._rx_empty = BoardBuffers(), -1
        self._contradictions.clear()
        self.last_report_at = now
        self._requests.clear()
        return [WasReset(banner=banner, expected=expected, lost=lost, unsent=unsent)]

    def _drop_queue(self) -> tuple[GrblLine, ...]:
        unsent = tuple(self._queue)
        self._queue.clear()
        return unsent

    def _drop_lines(self) -> tuple[tuple[GrblLine, ...], tuple[GrblLine, ...]]:
        lost = tuple(line for line, _ in self._in_flight)
        self.counts.lost += len(lost)
        self._in_flight.clear()
        self._in_flight_bytes = 0
        self._contradictions.answered()
        return lost, self._drop_queue()

    def executed_all(self) -> None:
        """Note that all acknowledged lines have been executed (a ``G4 P0`` was answered and the board is idle)."""
        self._executed(self.counts.acknowledged)

    def _executed(self, count: int) -> None:
        self.counts.executed = max(self.counts.executed, count)

    def poll_now(self) -> None:
        """Request a status report with the next output."""
        self._next_poll = 0.0

    def output(self, now: float) -> bytes:
        """Return the bytes to write now; the caller must write them."""
        out = bytearray(self._realtime)
        self._realtime.clear()
        if self.awaiting_banner and now - self._reset_at >= RESET_RETRY_S:
            out += SOFT_RESET
            self._reset_at = now
        self._resets_unanswered += out.count(SOFT_RESET)
        if self._may_poll() and now >= self._next_poll and now >= self._quiet_until:
            self._requests.drop_lost(self.poll_interval_s, now)
            doubted = self.sets_feed_back and bool(self._requests)
            out += 2 * (FULL_FEED + STATUS) if doubted else STATUS
            self._requests.ask(2 if doubted else 1, now)
            rare = self.polls_spared and bool(self._queue) and self._wire_bound and not self.paused
            self._next_poll = now + (max(self.poll_interval_s, WIRE_BOUND_POLL_S) if rare else self.poll_interval_s)
        while self._may_send(now):
            line = self._queue.popleft()
            self._in_flight.append((line, now))
            self._in_flight_bytes += line.size
            self.counts.sent += 1
            out += line.text.encode("ascii") + b"\n"
        self.counts.bytes_sent += len(out)
        return bytes(out)

    @property
    def _wire_bound(self) -> bool:
        return self._roomy_reports >= WIRE_BOUND_REPORTS

    def _may_poll(self) -> bool:
        """Whether to send a `?`: not during an EEPROM write, nor during a reset, when a report may be older than it."""
        deaf = bool(self._in_flight) and self._in_flight[0][0].eeprom  # it is writing to its EEPROM
        return self.polling and not deaf and not self.awaiting_banner

    def _may_send(self, now: float) -> bool:
        if not self._queue or self.awaiting_banner or self.paused or now < self._quiet_until:
            return False
        line = self._queue[0]
        if not self._in_flight:
            return True  # It fits every board; noise may have damaged the reported size of the buffer.
        if line.alone or self._in_flight[-1][0].alone:
            return False
        spare = 0 if self._wire_bound else SPARE_LINES * line.size
        # One byte less than the buffer: ring buffers of older builds hold one byte less than they report. Noise may
        # have damaged the size in [OPT:], which arrives once; the reports repeat it.
        room = self.rx_bytes - 1 if self._rx_empty < 0 else min(self.rx_bytes - 1, self._rx_empty)
        return self._in_flight_bytes + line.size + spare <= room

    def deadline(self, now: float) -> float:
        """Return when :meth:`output`, just called at ``now``, is due again even if nothing is received."""
        times = [float("inf")]
        if self._may_poll():
            times.append(max(self._next_poll, self._quiet_until))
        # Lines that wait for room wait for an answer; only lines that wait for a pause have a time.
        if self._queue and now < self._quiet_until:
            times.append(self._quiet_until)
        if self.awaiting_banner:
            times.append(self._reset_at + RESET_RETRY_S)
        return min(times)

    def silent_for(self, now: float) -> float:
        """Return the seconds since the last report or banner; 0 before polling has begun."""
        return 0.0 if self.last_report_at is None or not self.polling else now - self.last_report_at
