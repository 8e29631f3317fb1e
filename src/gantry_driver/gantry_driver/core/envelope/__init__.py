"""Where trajectories may go at the panel: its plane, the allowed travel of each intent, the free space above; pure."""
