"""Nuisances that are fitted beside the machine: timing, holds, transients, initial states, reversals."""
