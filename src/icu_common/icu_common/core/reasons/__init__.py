"""What one program or part tells another: codes with values, which English is made of only for people.

``message`` is a text that keeps its code and values; ``catalogue`` reads its English sentence. ``codes`` has the codes
of states. ``state_text`` separates a published state from its reason; no other module takes the text of a state apart.
"""
