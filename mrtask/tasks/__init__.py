"""Tasks: co-safe LTL formulas over interactions with objects, and the automata that say when they are done."""
