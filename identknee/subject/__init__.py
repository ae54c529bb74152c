"""The nouns a user brings: surfaces, frames, ligaments, the knee, and the readers of them."""
