"""Multi-robot, learning-informed task planning under uncertainty, as a library.

The packages follow the way of the data: ``homes -> maps -> tasks -> likelihood -> planning -> execution -> analysis``;
each imports only those before it.
"""
