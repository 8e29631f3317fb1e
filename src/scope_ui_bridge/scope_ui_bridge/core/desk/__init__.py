"""The operator's desk: all decisions about pages and orders.

Enters: texts of pages, reports of the graph, answers, and the time. Leaves: effects for the server to carry out. Start
with ``desk``. ``state`` is what its parts share: ``pages``, the selection (``chosen``), changes of control
(``handover``), ``stops``, orders (``actions``, ``motions``, ``order_book``, ``early_reset``), ``answers``,
``supervision`` of the page in control, and what the pages show (``state_feed``, ``tip_path``).
"""

from scope_ui_bridge.core.desk.desk import Desk

__all__ = ["Desk"]
