"""Carries out what the desk decides: a stop before it is recorded, every other order after its record is on disk."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from icu_common.core.reasons.message import Message
from scope_ui_bridge.adapters.audit_writer import AuditWriter
from scope_ui_bridge.adapters.graph_port import GraphPort, GraphUnavailable, read_clocks
from scope_ui_bridge.adapters.recorder import Recorder
from scope_ui_bridge.adapters.stop_path import StopPath
from scope_ui_bridge.adapters.tasks import Tasks
from scope_ui_bridge.adapters.video.held_image import HeldImage
from scope_ui_bridge.adapters.web.open_pages import OpenPages
from scope_ui_bridge.adapters.web.websockets import until_gone
from scope_ui_bridge.core.desk import Desk
from scope_ui_bridge.core.effects import (
    Broadcast,
    CallService,
    Effect,
    End,
    HoldPicture,
    MachineOrder,
    Ping,
    PublishHeartbeat,
    Record,
    RepeatOrder,
    SendCommand,
    SendGoal,
    SendSequence,
    SendTeaching,
    SendToViewer,
    StopNow,
)


class EffectRunner:
    """Sends to pages, graph, recorder and audit file.

    Parameters
    ----------
    desk
        Decides whether an order is still wanted, and receives the answers.
    graph, stop_path, pages, held, recorder, writer
        Receive the effects.
    tasks
        Keeps the orders that wait for their records.
    service_answered
        Called in any thread with the log entry's number and a service's answer.
    """

    def __init__(
        self,
        desk: Desk,
        *,
        graph: GraphPort,
        stop_path: StopPath,
        pages: OpenPages,
        held: HeldImage,
        recorder: Recorder,
        writer: AuditWriter,
        tasks: Tasks,
        service_answered: Callable[[int, bool, str], None],
    ) -> None:
        self._desk = desk
        self._graph = graph
        self._stop_path = stop_path
        self._pages = pages
        self._held = held
        self._recorder = recorder
        self._writer = writer
        self._tasks = tasks
        self._service_answered = service_answered

    def run(self, effects: list[Effect]) -> None:
        """Carry out effects in their order."""
        for effect in effects:
            if isinstance(effect, StopNow):
                self._stop_path.send(effect)
            elif isinstance(effect, PublishHeartbeat):
                self._graph.heartbeat()
            elif isinstance(effect, Ping):
                if (socket := self._pages.socket(effect.viewer)) is not None:
                    self._tasks.spawn(until_gone(socket.ping()))
            elif isinstance(effect, SendToViewer):
                self._pages.send(effect.viewer, effect.message)
            elif isinstance(effect, Broadcast):
                self._pages.broadcast(effect.message)
            elif isinstance(effect, HoldPicture):
                self.run(self._desk.picture_held(effect.viewer, self._held.hold()))
            elif isinstance(effect, RepeatOrder):
                self._tasks.spawn(self._send(effect.order))
            elif isinstance(effect, Record):
                self._writer.write_later(effect.record)
            elif isinstance(effect, End):
                continue  # the connection's own task ends it
            else:
                assert isinstance(effect, MachineOrder)
                self._tasks.spawn(self._send(effect, self._writer.write(effect.record)))

    async def _send(self, order: MachineOrder, written: Future[None] | None = None) -> None:
        try:
            if written is not None:
                await asyncio.wrap_future(written)
            if not self._desk.still_wanted(order, read_clocks(self._graph)):
                raise GraphUnavailable(Message("bridge.stopped_before_went_out"))
            self._to_graph(order)
        except OSError as error:
            self._failed(order, Message("bridge.record_could_not_written", error=error))
        except GraphUnavailable as error:
            self._failed(order, str(error))

    def _failed(self, order: MachineOrder, reason: str) -> None:
        self.run(self._desk.answers.order_failed(order, reason, read_clocks(self._graph)))

    def _to_graph(self, order: MachineOrder) -> None:
        if isinstance(order, SendCommand):
            self._graph.send_command(order.text)
        elif isinstance(order, SendSequence):
            self._graph.send_sequence(order.text)
        elif isinstance(order, SendTeaching):
            self._graph.send_teaching(order.text, *self._held.content)
        elif isinstance(order, SendGoal):
            self._graph.send_goal(order.frame, order.point, order.stamp_ns)
        elif isinstance(order, CallService):
            who = str(order.record["who"])
            self._call(order.service, who, lambda ok, text: self._service_answered(order.entry, ok, text))

    def _call(self, service: str, who: str, answered: Callable[[bool, str], Any]) -> None:
        if service == "record":
            self._recorder.start(answered, who)
        elif service == "end_record":
            self._recorder.end(answered)
        else:
            self._graph.call(service, answered)
