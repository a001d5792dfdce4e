"""Chains, their parameters and forward model, places; the documents of models and diagnoses."""
