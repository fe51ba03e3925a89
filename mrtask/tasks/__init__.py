"""Tasks: co-safe LTL formulas over interactions with objects, and the automata that tell when they are done."""
