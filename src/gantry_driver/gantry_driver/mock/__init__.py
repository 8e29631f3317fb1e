"""A GRBL 1.1 controller board in software, behind a pseudo-terminal; shares no code with the driver."""
