"""Messages between programs and parts: codes with values. They become English text only for people.

``message`` is a text that keeps its code and values; ``catalogue`` reads its English sentence. ``codes`` has the codes
of states. ``state_text`` separates a published state from its reason; no other module takes the text of a state apart.
"""
