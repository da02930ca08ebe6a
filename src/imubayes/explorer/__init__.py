"""The loop in a browser: a server on this machine, its page, and the linear algebra that answers a gesture."""
