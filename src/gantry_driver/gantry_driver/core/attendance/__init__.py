"""Whether the program that lowered the stylus still attends to it; pure, no clock."""
