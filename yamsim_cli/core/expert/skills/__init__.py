"""Skills of experts, each planned from the present state, and programs of skills."""
