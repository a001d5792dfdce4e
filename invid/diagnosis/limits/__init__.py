"""What a recording would have shown, had it been there."""
