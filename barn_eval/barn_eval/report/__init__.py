"""Reports: what runs and campaigns have found, as one HTML page with figures and tables beside it."""
