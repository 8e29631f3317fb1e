"""Pure rules of playing and recording: what is missing, and which message is dropped."""
