"""From hypotheses to ranked answers: searches until they agree, equal answers, close calls decided."""
