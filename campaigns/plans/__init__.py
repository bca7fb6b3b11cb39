"""Random plans, rehearsed and run with errors: does anything ever hit anything? And do bad ones get through?"""
