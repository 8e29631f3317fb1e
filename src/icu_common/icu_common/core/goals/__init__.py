"""Orders to the robot and its answers: ``intent``, ``sequence`` and ``results``."""
