"""Machines drawn at random, integrated by code of their own, written as foreign files with a map."""
