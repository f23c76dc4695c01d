"""The subcommands of `barn`: options in, a plain function called, a table or JSON out."""
