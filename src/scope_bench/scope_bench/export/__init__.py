"""What is taken out of a bag for other programs: tables, images, datasets for learning, recordings to look at."""
