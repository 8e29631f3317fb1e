"""Files of bags: reading them as they are, and writing them in parts."""
