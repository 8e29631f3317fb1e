"""Images for the pages.

``video_hub`` distributes the newest ones, ``jpeg_encoder`` encodes them in a process of its own, and ``held_image``
keeps the one in which an engineer marks a panel.
"""
