"""Start of the whole graph (bring-up, launch), and bags: record, play, check, info, export."""
