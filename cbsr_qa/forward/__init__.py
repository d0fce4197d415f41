"""Forward model: meshing, complete electrode model, Jacobian, exact local updates."""
