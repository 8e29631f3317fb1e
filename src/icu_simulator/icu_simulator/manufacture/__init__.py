"""The panel as manufactured and aged; the robot gets the nominal layout file."""
