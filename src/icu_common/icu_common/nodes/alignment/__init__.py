"""Conversion of values about cameras and layouts to messages and back."""
