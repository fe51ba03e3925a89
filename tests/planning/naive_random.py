"""splitmix64 in plain Python: the twin of `mrtask.planning.compiled.random_unit`."""

MASK = 2**64 - 1


class SplitMix64:
    """Steele, Lea and Flood (2014), "Fast splittable pseudorandom number generators", figure 5, mix variant 13."""

    def __init__(self, seed):
        self.state = seed & MASK

    def next_bits(self):
        self.state = (self.state + 0x9E3779B97F4A7C15) & MASK
        bits = self.state
        bits = (bits ^ bits >> 30) * 0xBF58476D1CE4E5B9 & MASK
        bits = (bits ^ bits >> 27) * 0x94D049BB133111EB & MASK
        return bits ^ bits >> 31

    def unit(self):
        """Uniform in [0, 1), of the upper 53 bits."""
        return (self.next_bits() >> 11) / 2**53
