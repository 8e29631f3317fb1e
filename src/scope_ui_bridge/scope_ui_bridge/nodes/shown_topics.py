"""Images, corners and edges, subscribed to only while a page shows them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sensor_msgs.msg import PointCloud2

from icu_common.nodes import qos
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.images import ReceivedImage
from icu_common.nodes.messages.cameras import image_array
from icu_common.nodes.messages.clouds import cloud_array
from icu_common.nodes.newest import NewestImage
from icu_common.nodes.timers import every
from scope_ui_bridge.adapters.web.web_server import WebServer
from scope_ui_bridge.core.desk import Desk
from scope_ui_bridge.core.video import CORNERS, EDGES
from scope_ui_bridge.nodes.arrival import Arrival
from scope_ui_bridge.nodes.checked_subscription import subscribe

_LAYER_TOPICS = {
    (CORNERS, "left"): "left/corners",
    (CORNERS, "right"): "right/corners",
    (EDGES, "left"): "left/edge_lines",
    (EDGES, "right"): "right/edge_lines",
}
_LAYER_COLUMNS = {CORNERS: ("u", "v"), EDGES: ("u", "v", "line")}
_SHOWN_PERIOD_S = 0.2


class ShownTopics:
    """Follows what the pages show.

    The left camera is needed while any page is connected: the bridge stops a page's motion that has no images, and
    a panel is taught in its image.
    """

    def __init__(self, node: GraphNode, server: WebServer, desk: Desk, arrival: Arrival) -> None:
        self._node = node
        self._server, self._mail = server, server.mailbox
        self._desk = desk
        self._arrival = arrival
        self._layers: dict[tuple[str, str], Any] = {}
        self._images: dict[str, NewestImage] = {}
        self._follow()
        every(node, _SHOWN_PERIOD_S, self._follow, wall=True)

    def _follow(self) -> None:
        video = self._server.video
        for key in video.wanted - self._layers.keys():
            self._layers[key] = subscribe(
                self._node, PointCloud2, _LAYER_TOPICS[key], qos.SENSOR, self._layer_taker(*key)
            )
        for key in self._layers.keys() - video.wanted:
            self._node.destroy_subscription(self._layers.pop(key))
        cameras = video.cameras | ({"left"} if self._desk.has_viewers else set())
        for side in cameras - self._images.keys():
            self._images[side] = NewestImage(self._node, f"{side}/image_raw", self._image_taker(side))
        for side in self._images.keys() - cameras:
            self._images.pop(side).end()
            self._mail.newest(side, video.forget, side)

    def _layer_taker(self, layer: str, camera: str) -> Callable[[PointCloud2], None]:
        take, columns = self._desk.scene.layers.take, _LAYER_COLUMNS[layer]
        return lambda message: self._mail.newest(
            f"{layer} {camera}", take, layer, camera, self._arrival.stamp_ns(message), cloud_array(message, columns)
        )

    def _image_taker(self, side: str) -> Callable[[ReceivedImage], None]:
        def take(message: ReceivedImage) -> None:
            try:
                image = image_array(message)
            except ValueError as error:
                self._node.get_logger().error(f"{side} picture ignored: {error}", throttle_duration_sec=5.0)
                return
            stamp = self._arrival.stamp_ns(message)
            self._mail.newest(side, self._server.video.offer, side, stamp, message.encoding, image)
            self._mail.newest("picture", self._server.post_value, self._desk.machine.picture_came)

        return take
