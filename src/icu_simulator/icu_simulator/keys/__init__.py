"""Keys with a force: travel, actuation point and force curve of each kind."""
