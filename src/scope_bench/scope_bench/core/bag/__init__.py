"""Pure rules of playback and recording: missing messages, and the choice of dropped ones."""
