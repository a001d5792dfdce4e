"""Pieces that several laws share."""
