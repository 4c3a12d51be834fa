"""The paper's protocol, and all its tables as ours."""
