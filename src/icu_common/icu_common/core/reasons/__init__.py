"""What one program or part tells another: codes with values, which English is made of only for people.

``codes`` has the codes of states. ``state_text`` separates a published state from its reason; no other module takes
the text of a state apart.
"""
