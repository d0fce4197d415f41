"""The words of the trade: frozen dataclasses that every layer and every plugin may use.

Nothing here imports anything but the standard library and numpy.
"""
