"""From a finished search to a diagnosis: names, lack of fit, intervals, confounds, open-loop gap."""
