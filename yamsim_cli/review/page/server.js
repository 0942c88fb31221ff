// Requests to the server, and this page's right to decide.

let token = "";

async function post(path, body) {
  const answer = await fetch(path, {
    method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify({...body, token}),
  });
  return {status: answer.status, data: await answer.json()};
}

/** Return the JSON at a path; throw an Error with the server's message. */
export async function get(path) {
  const answer = await fetch(path);
  const data = await answer.json();
  if (!answer.ok) throw new Error(data.error);
  return data;
}

/** Claim the right to decide, and renew it; `told` gets whether this page holds it. */
export function keepClaim(told) {
  async function renew(takeOver) {
    try {
      const {status, data} = await post("/api/claim", {take_over: takeOver});
      if (status === 200) token = data.token;
      told(status === 200 ? "held" : "other");
    } catch {
      told("gone");
    }
  }
  addEventListener("pagehide", () => navigator.sendBeacon("/api/release", JSON.stringify({token})));
  addEventListener("pageshow", (event) => { if (event.persisted) renew(false); });
  setInterval(() => renew(false), 2000);
  renew(false);
  return () => renew(true);
}

/** Store a decision; throw an Error with the server's message. */
export async function decide(body) {
  const {status, data} = await post("/api/decide", body);
  if (status !== 200) throw new Error(data.error);
  return data.decision;
}
