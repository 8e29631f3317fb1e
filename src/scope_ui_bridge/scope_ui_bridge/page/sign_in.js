// The sign-in page in the browser's language; without script it is in English.

import { startLanguage } from "./strings.js";

startLanguage();
