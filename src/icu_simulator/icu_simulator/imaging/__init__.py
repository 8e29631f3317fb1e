"""Effects of real cameras on the bench's images: lens, shutter, sensor, compression and stamps. Pure, like core."""
