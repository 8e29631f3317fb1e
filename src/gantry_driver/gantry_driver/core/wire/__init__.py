"""Protection against damaged bytes on the wire: what the board's reports must show of a goal.

``stages`` divides a path, ``watch`` compares reports with it, ``goal`` has the state of the proof of one goal, and
``faults`` has the codes of the contradictions. The proof itself is part of the machine.
"""
