"""Global plans as navfn makes them."""
