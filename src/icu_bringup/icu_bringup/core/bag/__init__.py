"""Rules of playback and recording: missing messages, the choice of dropped ones, the clock, and MCAP records."""
