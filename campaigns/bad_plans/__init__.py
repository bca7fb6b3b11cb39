"""Plans that must be refused. Each is a mutation of a good plan, stored with the text that its refusal must contain."""
