"""What each verb's answer says: the same sentences and tables on a terminal and on the page."""
