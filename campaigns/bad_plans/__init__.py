"""Plans that must be refused: each is one mutation of a good plan, with the text that its refusal must contain."""
