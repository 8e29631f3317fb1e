// Shows the sign-in page in the browser's language; without scripts it is in English.

import { startLanguage } from "./language/strings.js";

startLanguage();
