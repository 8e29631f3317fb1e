"""The web server and its connections. All input from a page is untrusted.

Start with ``web_server``: a thread with an event loop. ``listener`` accepts connections, ``front_door`` checks requests
and signs users in, ``languages`` lists the page's languages, and ``turned_away`` records what was refused.
``socket_gate`` admits WebSockets,
``control_sockets`` and ``video_sockets`` serve them by the functions of ``websockets``, ``open_pages`` sends to them,
and ``effect_runner`` carries out what the desk decides.
"""
