"""Identifications: the state machine, the runner process, and their resource."""
