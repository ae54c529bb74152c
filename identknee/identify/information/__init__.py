"""Fisher information, structural rank, and geodesics to the boundary of the model."""
