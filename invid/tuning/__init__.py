"""After the model: gains, notches, feedforward and shapers, with the margins they leave, and files for
drives.

Nothing here talks to a drive.
"""
