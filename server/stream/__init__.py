"""The stream: a client sends views as they change, and is sent pictures of the newest."""
