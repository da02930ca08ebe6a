"""The loop in words and tables: diagnosis, changes of a model, history."""
