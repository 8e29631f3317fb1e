"""Values of rotated cameras and deviating layouts that the programs exchange."""
