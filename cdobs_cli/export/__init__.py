"""The designed observer for use elsewhere: C, Python, matrices, JSON, a system of python-control."""
