"""Changes by the hand: menus and drags in the scene, ghosts of what waits, and the script of it."""
