"""splitmix64 (Steele et al. 2014) in Python integers: the twin of `mrtask.planning.compiled.random_unit`."""

MASK = 2**64 - 1


class SplitMix64:
    def __init__(self, seed):
        self.state = seed & MASK

    def unit(self):
        """Uniform in [0, 1): the upper 53 bits of the next word."""
        self.state = (self.state + 0x9E3779B97F4A7C15) & MASK
        word = self.state
        word = ((word ^ (word >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        word = ((word ^ (word >> 27)) * 0x94D049BB133111EB) & MASK
        return ((word ^ (word >> 31)) >> 11) / 2**53
