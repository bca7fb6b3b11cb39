"""Plans that must not pass: each is one mutation of a good one, with the words that its refusal must say."""
