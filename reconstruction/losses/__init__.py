"""Pure, differentiable training losses."""
