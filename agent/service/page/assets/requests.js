/* What the page asks of the service. What moves or writes carries the token; abort carries none and waits for none. */
const KEPT_AS = "volcal.token";

export const token = () => sessionStorage.getItem(KEPT_AS);
export const keepToken = (value) => (value ? sessionStorage.setItem(KEPT_AS, value) : sessionStorage.removeItem(KEPT_AS));

/* `problem`: what the service says of it (detail, hint, where, status). */
export class Refused extends Error {
  constructor(problem) {
    super(problem.detail ?? "");
    this.problem = problem;
  }
}

export async function read(path) {
  return (await answered(fetch(path, { headers: { accept: "application/json" } }))).json();
}

export async function ask(path, body, { withToken = true } = {}) {
  const headers = { "content-type": "application/json" };
  if (withToken && token()) headers.authorization = `Bearer ${token()}`;
  return (await answered(fetch(path, { method: "POST", headers, body: JSON.stringify(body ?? {}) }))).json();
}

/* A file that needs the token. */
export async function fetchFile(path) {
  return (await answered(fetch(path, { headers: { authorization: `Bearer ${token()}` } }))).blob();
}

async function answered(request) {
  const response = await request;
  if (response.ok) return response;
  let problem = { status: response.status, detail: response.statusText };
  if ((response.headers.get("content-type") ?? "").includes("json")) problem = { ...problem, ...(await response.json()) };
  throw new Refused(problem);
}
