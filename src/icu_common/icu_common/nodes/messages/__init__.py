"""The only place where messages are packed and unpacked; everything else works on numpy arrays and dataclasses."""
