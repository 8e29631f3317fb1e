"""Steps of simulated time: a table in shared memory (``step_ledger``, ``step_layout``) and when a step may begin
(``step_gate``).
"""
