"""Who gets in, and how much of the server each one may use."""
