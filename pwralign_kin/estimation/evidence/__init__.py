"""What speaks for an answer and against it, and the confidence that follows."""
