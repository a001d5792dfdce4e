"""What the simulation gets wrong: search, acceptance, doubt, verdict, sentences."""
