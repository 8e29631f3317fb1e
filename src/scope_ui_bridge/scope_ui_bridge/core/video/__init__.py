"""The live image and what is drawn over it.

Enters: cameras, poses, controls and detected features; acknowledgements of drawn images. Leaves: outlines in pixels,
and the form in which the next image is sent. ``scene`` projects panel, stylus and target, ``layers`` prepares corners
and edges, and ``frame_window`` limits the images in flight.
"""

from scope_ui_bridge.core.video.frame_window import FORMS, Form, FrameWindow
from scope_ui_bridge.core.video.layers import CORNERS, EDGES, LAYERS
from scope_ui_bridge.core.video.scene import Face, VideoScene, labels_of, moved_m

__all__ = ["CORNERS", "EDGES", "FORMS", "LAYERS", "Face", "Form", "FrameWindow", "VideoScene", "labels_of", "moved_m"]
