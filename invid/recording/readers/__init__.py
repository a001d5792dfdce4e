"""Readers of foreign files, one kind a module: named columns of numbers, nothing converted."""
