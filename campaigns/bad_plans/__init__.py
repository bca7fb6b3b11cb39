"""Bad plans: plans that the agent must refuse.

Each bad plan is a mutation of a good plan and is stored with the text that the refusal (an error message) must contain.
"""
