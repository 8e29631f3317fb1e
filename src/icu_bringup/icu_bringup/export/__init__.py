"""Export of bags for other programs: tables, images, datasets for learning, recordings for viewers."""
