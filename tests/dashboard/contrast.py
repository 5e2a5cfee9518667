"""Contrast of the texts that a browser shows, from computed styles.

Source: WCAG 2.2, 1.4.3 and 1.4.11.
"""

from typing import Any, NamedTuple

LEAST, LEAST_OF_SIGNS = 4.5, 3.0

# Whatever lies under the middle of a text is its ground, from the text down to the first opaque
# colour. Texts that something covers, or that are scrolled away, are not met there.
_MEASURE = r"""()=>{
const all=document.createElement('style');
all.textContent='*{pointer-events:auto!important}.bin{pointer-events:none!important}';
document.head.append(all);
const canvas=document.createElement('canvas').getContext('2d',{willReadFrequently:true});
const bytes=(text,opacity=1)=>{canvas.clearRect(0,0,1,1);canvas.fillStyle='#0000';
  canvas.fillStyle=text;canvas.fillRect(0,0,1,1);const [r,g,b,a]=canvas.getImageData(0,0,1,1).data;
  return [r,g,b,a/255*opacity]};
const over=(top,low)=>[0,1,2].map(i=>top[i]*top[3]+low[i]*(1-top[3]));
const light=c=>c.slice(0,3).map(v=>v/255).map(v=>v<=.04045?v/12.92:((v+.055)/1.055)**2.4)
  .reduce((sum,v,i)=>sum+v*[.2126,.7152,.0722][i],0);
const opacity=e=>{let share=1;for(;e;e=e.parentElement)share*=+getComputedStyle(e).opacity;
  return share};
const isShape=e=>e instanceof SVGElement&&!(e instanceof SVGSVGElement)&&
  !/^(text|tspan|g)$/.test(e.tagName);
const fill=e=>{const s=getComputedStyle(e);
  return isShape(e)?(s.fill==='none'?[0,0,0,0]:bytes(s.fill,+s.fillOpacity*opacity(e)))
    :e instanceof SVGElement?[0,0,0,0]:bytes(s.backgroundColor,opacity(e))};
const walk=document.createTreeWalker(document.body,NodeFilter.SHOW_TEXT),found=new Map();
while(walk.nextNode()){
  const e=walk.currentNode.parentElement,words=walk.currentNode.textContent.trim();
  if(!words||e.closest('script,style,title,:disabled,[data-disabled],.mantine-Notification-root'))
    continue;
  const range=document.createRange();range.selectNodeContents(walk.currentNode);
  const box=range.getBoundingClientRect(),s=getComputedStyle(e);
  if(box.width<2||box.height<2||s.visibility==='hidden')continue;
  const under=document.elementsFromPoint(box.x+box.width/2,box.y+box.height/2);
  const place=under.findIndex(one=>one===e||(e.tagName==='tspan'&&one===e.parentElement));
  if(place<0||under.slice(0,place).some(one=>!e.contains(one)&&fill(one)[3]>.5))continue;
  let ground=null;
  const layers=[];
  if(e instanceof SVGElement&&s.paintOrder.startsWith('stroke')&&s.stroke!=='none')
    layers.push(bytes(s.stroke));
  for(const one of under.slice(place)){
    if(layers.length&&layers.at(-1)[3]>=.999)break;
    if(one.tagName==='CANVAS')break;
    layers.push(fill(one));
  }
  ground=bytes(getComputedStyle(document.body).backgroundColor);
  for(const layer of layers.reverse())ground=over(layer,ground);
  const ink=over(bytes(e instanceof SVGElement?s.fill:s.color,opacity(e)),ground);
  const [low,high]=[light(ink),light(ground)].sort((a,b)=>a-b);
  const ratio=(high+.05)/(low+.05),hex=c=>'#'+c.slice(0,3).map(v=>Math.round(v).toString(16)
    .padStart(2,'0')).join('');
  const key=hex(ink)+' on '+hex(ground),old=found.get(key);
  found.set(key,{ratio,pair:key,times:(old?.times??0)+1,words:old?.words??words.slice(0,40),
    where:old?.where??(e.closest('[data-testid]')?.dataset.testid??e.className?.baseVal??
    String(e.className)).slice(0,40)});
}
all.remove();
return [...found.values()].sort((a,b)=>a.ratio-b.ratio)}"""


class Pair(NamedTuple):
    """Texts of one colour on one ground: how many, the words and the place of the first."""

    ratio: float
    pair: str
    times: int
    words: str
    where: str

    @property
    def is_faint(self) -> bool:
        """Whether the text, or the sign without a letter, has too little contrast."""
        least = LEAST if any(map(str.isalnum, self.words)) else LEAST_OF_SIGNS
        return self.ratio < least


def pairs_of(tab: Any) -> list[Pair]:
    """Return the colours of the visible texts with their grounds, the faintest first."""
    return [Pair(**found) for found in tab.evaluate(_MEASURE)]
