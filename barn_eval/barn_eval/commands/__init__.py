"""The subcommands of `barn`, one module each: options in, a plain function called, a table or JSON out."""
