"""From hypotheses to ranked answers: searches until they agree, equal answers, limbs mended, close calls decided."""
