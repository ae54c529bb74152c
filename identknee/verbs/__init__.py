"""What a user asks for: each verb takes a knee and its laxity and gives back the whole answer."""
