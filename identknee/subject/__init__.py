"""The nouns a user brings: surfaces, frames, ligaments, the knee, and the readers that make them."""
