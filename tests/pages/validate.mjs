// Prints what html-validate says of each file, one finding a line.
import { readFileSync } from "node:fs";
import { HtmlValidate, StaticConfigLoader } from "html-validate";

const checker = new HtmlValidate(new StaticConfigLoader({ extends: ["html-validate:recommended"] }));
for (const path of process.argv.slice(2)) {
  const report = await checker.validateString(readFileSync(path, "utf8"));
  for (const { messages } of report.results)
    for (const one of messages) console.log(`${path}:${one.line}: ${one.ruleId}: ${one.message}`);
}
