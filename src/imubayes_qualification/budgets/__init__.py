"""The unit as its certificate states it, with the uncertainty budgets of its quantities."""
