"""What causes leave: said in words, and as a law without a name."""
