"""Simulators of other hands: what they get wrong on a recording, and their corrected copies."""
