"""The command ``ngvisco``: a thin layer over ``ngvisco.case`` and ``ngvisco.run``."""
