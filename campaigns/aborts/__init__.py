"""One whole run, broken off at each of its steps in every way: is the machine always left as it was found?"""
