"""Compiled programs that are kept between processes, and the settings of JAX."""
