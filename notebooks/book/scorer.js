// Search: chapters first, then report and glossary, the library reference last. A result is [page, title, anchor, …, score].
var Scorer = {
  score: (result) => result[4] + (result[0].startsWith("notebooks/") ? 30 : result[0].startsWith("reference/") ? -30 : 0),
  objNameMatch: 11, objPartialMatch: 6, objPrio: {0: 15, 1: 5, 2: -5}, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
};
