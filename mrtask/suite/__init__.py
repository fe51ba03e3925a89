"""A suite of trials that never changes, so that planners' scores can be quoted and compared.

``mrtask score my_lab.Cautious`` runs a planner on it.
"""
