"""Depth, camera, labels and pose against the scene itself: what cannot be is mended and said, or refused.

Each check returns notes of one line, or raises FrameError. Knows frames and planes, not files.
"""
