"""Pure parts: sessions, frames of a dataset, and what a bag contains."""
