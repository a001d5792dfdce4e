"""What invid says, as codes with values, and each language's words for them."""
