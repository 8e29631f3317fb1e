"""States as values: ``machine_states`` has those of the machine, their transitions, and the events for the node.

``stylus_state`` has the states of the stylus, which may be down, and ``reasons`` the reasons that have a code.
"""
