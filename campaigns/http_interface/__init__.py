"""Trial of the HTTP interface against its own OpenAPI document."""
