"""Reports that the programs of a graph exchange about themselves: ``preparation``, ``delays``, ``processor_load``,
``supervision``, and messages that are still being processed (``outstanding``).
"""
