"""Other processes of this computer: their identity (``process_identity``), whether they run (``sign_of_life``,
``hanging_programs``), their end (``program_end``), and their use of the processor (``processor_load``).
"""
