"""Forms in which people have frames: camera files, poses, depth, labels, clouds. Knows no scene, no plane.

Each module turns one kind of file or array into plain numbers [m, px, OpenCV axes] or refuses it in one line.
"""
