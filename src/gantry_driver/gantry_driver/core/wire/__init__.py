"""Protection against damaged bytes on the wire: what the board's reports must show of a goal."""
