"""The subcommands of `barn`: options in, a plain function, a table or JSON out."""
