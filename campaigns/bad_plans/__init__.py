"""Plans that the agent must refuse.

Each plan is a mutation of a good plan and is stored with the text that the refusal must contain.
"""
