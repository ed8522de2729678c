// Search: titles and headings first, of the users' guide before those of chapters; then chapters, report and glossary; the
// library reference last. A result is [page, title, anchor, description, score, file, kind].
var Scorer = {
  score: ([page, , , , score, , kind]) => {
    if (page.startsWith("reference/")) return score - 30;
    if (kind === "title") return score + 60;
    if (page.startsWith("notebooks/")) return score + 30;
    return score + (score >= Scorer.title ? 40 : 0);
  },
  objNameMatch: 11, objPartialMatch: 6, objPrio: {0: 15, 1: 5, 2: -5}, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
};
