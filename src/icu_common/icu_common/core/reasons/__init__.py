"""What one program or part tells another: codes with values, which English is made of only for people.

``state_text`` separates a published state from its reason, and nothing else looks into the text of a state.
"""
